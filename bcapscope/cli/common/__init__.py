"""Shared code of the commands: options, prompts, exit codes and reading captures."""
