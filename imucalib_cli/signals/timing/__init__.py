"""Stamps: order, bursts, and offsets between two streams."""
