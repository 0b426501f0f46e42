"""The registered scenes, one file each."""
