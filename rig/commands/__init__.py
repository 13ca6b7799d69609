"""The commands, grouped by purpose. They parse, call and print; they calculate nothing."""
