"""The frozen result: written and read as YAML, JSON, URDF, tf arguments and words."""
