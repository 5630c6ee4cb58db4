"""rosbag2's SQLite files."""
