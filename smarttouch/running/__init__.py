"""One run, from a source to the skin: every command, example and test goes through it."""
