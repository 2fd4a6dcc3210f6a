"""What several commands share: options, prompts, exit codes, reading captures."""
