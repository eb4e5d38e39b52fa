"""Small probabilities: failure where a function of independent standard normal variables is negative.

`auto.find_probability` is the door: it starts with the design points, goes on with subset simulation, and
answers with importance sampling that the others certify.
"""

from typing import Final

#: looks at untouched space that learning takes for every variable before it is believed
LOOKS: Final = 3
