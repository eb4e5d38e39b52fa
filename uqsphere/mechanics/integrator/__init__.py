"""Numerical integration of the equations of motion of a batch of scenes.

A row is one scene; a lane holds a row while it is integrated, and all lanes take one step at a
time: a stretch of the motion that one power series describes.  Begin with `solve`, which turns
scenes into rows and rows into answers; then `kernel`, whose first lines list what happens in a
step and which module does it: `kernel.march` is that list as code, `events.after_step` what can
end a step, the end of `kernel._go_on` what can end a record, `records.finish` its answers.
`tracked` is the list of everything that a lane knows.
"""
