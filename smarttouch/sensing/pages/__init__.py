"""A virtual finger over a page: the page, the way of the finger, the frames it sees."""
