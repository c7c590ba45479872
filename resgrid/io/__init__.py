"""Result files: writers of paths, runs, solutions and netlists, with one encoder for each file format.

Writers may import the packages of the results that they write, but no module for pictures or the command line.
"""
