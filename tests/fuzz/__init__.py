"""Inputs that nobody thought of: mutations of valid files, random formulas and grids, each judged independently."""
