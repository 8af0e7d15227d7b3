# Only the moment knows which runs go on, and who is in them.
complete -c rangehound -n "not __fish_rangehound_needs_command" -l name -x -a "(rangehound names runs 2>/dev/null)"
complete -c rangehound -n "__fish_rangehound_using_subcommand kill" -f -a "(rangehound names nodes 2>/dev/null)"
complete -c rangehound -n "__fish_rangehound_using_subcommand restart" -f -a "(rangehound names nodes 2>/dev/null)"
