"""Experiments on simulated recordings: trials in memory, and the bound they are held against."""
