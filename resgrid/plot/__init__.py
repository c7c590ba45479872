"""Pictures: every function takes values and an axes, draws, and returns the axes."""
