"""resgrid: a robot's surroundings compiled into a resistor grid, solved, and driven along its currents."""
