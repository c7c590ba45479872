"""Circuit checks: electrical rules (ERC), portability between simulators, and comparison with a simulator run."""
