"""A proved scan sequence becomes bytes on a wire: boards, their drivers, and what stops them."""
