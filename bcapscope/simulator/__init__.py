"""The simulator: a model of a controller without I/O or clock, and the server that adds both.

`behaviours.md` lists what the model does, with the source or the assumption behind each behaviour. For each
command, `bcapscope/protocol/tables/commands.tsv` names the public sources that document or use the command.
"""
