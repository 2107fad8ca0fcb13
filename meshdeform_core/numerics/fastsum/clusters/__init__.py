"""Clusters of sources and groups of targets: trees, boxes, bricks, and when a cluster is far enough."""
