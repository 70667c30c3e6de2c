"""Studies that reproduce the papers' experiments: one module a thesis chapter or paper, each with `run(seeds, quick, progress)`."""
