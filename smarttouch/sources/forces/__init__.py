"""How hard the finger presses: fixed, recorded, or by a load cell."""
