"""The upward fisheye: lens, rendering, mount, faults."""
