"""Space charge of particles in arrays: what a step, or any tracking code, calls for their field."""
