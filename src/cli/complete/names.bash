
# Only the moment knows which runs go on, and who is in them.
_rangehound_by_name() {
    local cur="${COMP_WORDS[COMP_CWORD]}" prev="${COMP_WORDS[COMP_CWORD-1]}" kind
    case "${prev}" in
        --name) kind=runs ;;
        kill|restart) kind=nodes ;;
    esac
    if [[ -z ${kind} || ${cur} == -* ]]; then
        _rangehound "$@"
    else
        COMPREPLY=( $(compgen -W "$("$1" names "${kind}" 2>/dev/null)" -- "${cur}") )
    fi
}

complete -F _rangehound_by_name -o bashdefault -o default rangehound
