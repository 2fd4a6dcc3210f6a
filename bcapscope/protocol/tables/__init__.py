"""Tables of what b-CAP defines and DENSO documents: functions, commands, result codes, variables."""
