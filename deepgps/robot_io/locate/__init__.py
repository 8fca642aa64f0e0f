"""Poses of images as they come: from files, folders and standard input, one line of JSON for each."""
