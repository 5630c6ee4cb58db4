"""Logs behind URLs, read in ranges through fsspec."""
