"""What a person writes (scenes, maps), and its sampling into a configuration space."""
