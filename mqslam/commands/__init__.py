"""The commands as Python functions; nothing here prints or parses arguments."""
