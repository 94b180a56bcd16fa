"""A proved scan sequence becomes bytes on a wire: the contract of boards, their seal and stops."""
