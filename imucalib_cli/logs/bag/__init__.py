"""Bags of ROS 1 (wiki.ros.org/Bags/Format/2.0)."""
