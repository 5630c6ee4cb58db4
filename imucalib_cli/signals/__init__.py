"""Signals over time: stamps, gaps, interpolation, Savitzky-Golay filters, Peano kernels, lag."""
