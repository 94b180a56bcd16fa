"""A page in the browser that shows a run, steers it, and can stop it."""
