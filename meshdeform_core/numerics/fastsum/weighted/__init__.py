"""Fast weighted sums (IDW) over a tree of sources."""
