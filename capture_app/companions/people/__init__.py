"""People in 3D while a rig runs, for other programs: OSC and the Lab Streaming Layer."""
