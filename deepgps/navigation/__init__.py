"""Navigation: a controller drives to goals in a method's own frame, by what the robot's sensors tell.

All but ``simulate`` would run on a robot. Nothing here opens the truth or an alignment of a map with the world.
"""
