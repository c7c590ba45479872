"""Result files: writers of paths, runs, solutions, netlists, resistances, boards and ROS recordings, and file encoders.

Writers may import the packages of the results that they write, but no module for pictures or the command line.
"""
