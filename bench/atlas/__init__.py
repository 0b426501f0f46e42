"""The failure atlas: executable experiments that show where methods fail, and what helps."""
