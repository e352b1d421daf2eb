"""What the commands do, callable from Python: nothing here prints or parses arguments."""
