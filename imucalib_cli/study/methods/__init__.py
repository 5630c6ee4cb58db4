"""Estimators that the published method and ours are compared with, as pure functions of data."""
