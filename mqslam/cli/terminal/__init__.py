"""What the commands share: options, progress, and the words of remedies."""
