"""Views of a run: terminal, window, pictures and figures."""
