"""Sample cases: each folder has a README.md, a case.toml and a generator with size parameters."""
