"""The energy of a repaired region, and Newton's method for its minimum."""
