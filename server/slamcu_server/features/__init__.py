"""Map features with their standing evidence."""
