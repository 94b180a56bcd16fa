"""Serial lines, TCP connections and packets, for boards and sensors."""
