"""Models that users bring from other programs, made into scenes."""
