"""Physics of a brittle sphere between two Hopkinson bars: deterministic, batches of rows, no random
numbers.
"""
