"""The ground of all rooms: errors, files, clocks, stopping, names; knows nothing of touch."""
