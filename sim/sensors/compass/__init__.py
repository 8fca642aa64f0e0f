"""The visual compass: the turn between two polar images."""
