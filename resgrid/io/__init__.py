"""Result files: writers of paths, runs, solutions and netlists, with one encoder for each file format."""
