"""Recordings of robots (bags of ROS 1 and ROS 2): their maps, updates, goals and transforms."""
