"""From a study to a result folder: draw, evaluate, ask and answer, until the accuracy or the budget is reached."""
