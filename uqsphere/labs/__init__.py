"""Labs: products beside the product, each with its own command, input file and page of docs.

Nothing outside imports a lab but the command table; a lab imports public names only.
"""
