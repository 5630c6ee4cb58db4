"""Poses of one mount over many recordings: has it moved, when, and by how much?"""
