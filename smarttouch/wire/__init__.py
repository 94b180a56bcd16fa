"""Serial lines, TCP, pseudo-terminals, and packets on them: what both ends of a wire share."""
