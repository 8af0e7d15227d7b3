# Only the moment knows which runs go on, and who is in them.
_rangehound_runs() { compadd -- ${(f)"$(_call_program runs rangehound names runs 2>/dev/null)"} }
_rangehound_nodes() { compadd -- ${(f)"$(_call_program nodes rangehound names nodes 2>/dev/null)"} }

