"""The mechanisms that come with alfmu, one folder each."""
