"""Code that several commands share: options, prompts, exit codes, and reading of captures."""
