"""Loops of transfinite interpolation: lines, faces, block interiors."""
