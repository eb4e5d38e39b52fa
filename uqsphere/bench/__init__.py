"""The command `bench`: speed against error on this machine, and the model beside published measurements."""
