"""Places of an audited map: the worst of them in words and as files, and those that could not be judged."""
