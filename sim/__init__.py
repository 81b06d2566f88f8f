"""The world: structure, motion, rig, renderer and the cameras that look at it."""
