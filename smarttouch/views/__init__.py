"""What is shown or written of a run: terminal, window, pictures, streams and figures."""
