"""Lab for split Hopkinson bars: records to forces, slow tests to a contact law, the design of a
test.
"""
