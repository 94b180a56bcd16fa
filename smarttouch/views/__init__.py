"""What is shown or written of a run: terminal, window, pictures, films, streams and figures."""
