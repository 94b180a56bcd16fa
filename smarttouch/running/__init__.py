"""One run from a source to the skin: runner, display, listeners, recordings, responses."""
