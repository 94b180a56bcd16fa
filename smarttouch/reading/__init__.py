"""Reading of texts, pages and screens with a fingertip, and measures of legibility."""
