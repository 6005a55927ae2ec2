"""Jao, Wang and Shkel 2020: foot-to-foot odometry with shoe cameras."""
