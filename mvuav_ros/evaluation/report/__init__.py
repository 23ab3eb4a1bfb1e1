"""What a report consists of, and how it becomes one page and the files beside it."""
