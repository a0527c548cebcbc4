"""FMI: the description of an FMU, its packing with pythonfmu, the slave inside it, and its validation."""
