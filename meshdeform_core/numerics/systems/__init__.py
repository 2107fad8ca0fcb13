"""Linear systems of radial basis functions (direct, greedy, Krylov), and products with matrices of small blocks."""
