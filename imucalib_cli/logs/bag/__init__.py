"""ROS 1 bags, format 2.0 (wiki.ros.org/Bags/Format/2.0)."""
