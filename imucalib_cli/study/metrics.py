"""How far one pose is from another: what results of all kinds are held against the truth with."""

from imucalib_cli.results.pose_error import PoseError, pose_error

__all__ = ["PoseError", "pose_error"]
