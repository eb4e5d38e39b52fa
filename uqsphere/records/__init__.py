"""Records of strain gauges: reading what a recorder wrote, mending it, pulses from it, forces and stiffness from it."""
