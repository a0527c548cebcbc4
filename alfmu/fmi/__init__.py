"""FMI: the description of an FMU, its packing with pythonfmu, the slave inside it, and its validation.

Other rooms import `checks.pages`, `checks.validation`, `drive`, `export`, `markup`, `native`, `recipe`, `sizes`,
`source`.
"""
