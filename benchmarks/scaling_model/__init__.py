"""A model of machines: plans and times of steps on ranks that need not exist, beside what was measured."""
