"""Fast sums of radial basis functions by skeletons of clusters."""
