"""Serial lines, TCP, pseudo-terminals, and packets on them, for both ends of a wire."""
