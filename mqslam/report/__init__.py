"""The pages of all commands: one self-contained HTML file each, from one template."""
