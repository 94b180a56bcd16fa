"""Texts, pages and screens pass under the finger; tests of what can be read of them."""
