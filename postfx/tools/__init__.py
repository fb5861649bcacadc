"""What looks at frames from outside: only the command line takes it."""
