"""Experiments on simulated recordings: runs in memory, compared with the Cramér-Rao bound."""
