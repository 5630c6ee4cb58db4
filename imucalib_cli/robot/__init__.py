"""From a URDF and pose streams to a kinematic path, vectorised over samples. Knows no filters."""
