"""Hidden mice: truths that are no twin with one number changed, and the seal on what is wrong with each."""
