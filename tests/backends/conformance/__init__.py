"""What every backend must do, whatever is behind it: ``docs/architecture.md`` says how to run it on one of your own."""
