"""Logs of plain text: CSV files, TUM and EuRoC folders."""
