"""Time: clocks, gaps, interpolation, Savitzky-Golay filters and their Peano kernels, lag."""
