"""MCAP files and ROS bags: read and written."""
