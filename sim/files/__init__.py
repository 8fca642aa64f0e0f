"""Files that are complete or absent, in which any changed bit is noticed."""
