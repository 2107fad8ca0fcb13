"""Linear systems of radial basis functions: direct, greedy, Krylov."""
