"""Radio: propagation, arrays, multiple access and the control of phases and powers, as array maths."""
