"""What a run can be asked: a question in each file, answered by one campaign."""
