"""The stages of a step, one module each: functions from values to a value that do not know each other."""
