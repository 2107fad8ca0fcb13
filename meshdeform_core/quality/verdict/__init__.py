"""The verdict on a deformed grid: its cells, inspected against those of the undeformed grid."""
