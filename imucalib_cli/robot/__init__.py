"""URDF and pose streams to a kinematic path, vectorised over samples; knows nothing of filters."""
