"""Fast sums over clusters of sources: trees, boxes, acceptance, passes."""
