"""Recordings: one MCAP file of ROS 2 messages, written, indexed and read."""
