# Completion of play-launch in bash.

_play_launch() {
    local answer program=${1/#\~/$HOME}
    COMPREPLY=()
    # With the mark, the wheels of ROS leave Python alone: the answer needs no library of theirs.
    answer=$(_ROS_WHEELS_BOOTSTRAP_COMPLETE=1 "$program" completion --answer bash \
        "${COMP_LINE:0:COMP_POINT}" "$COMP_WORDBREAKS" 2>/dev/null </dev/null) || return 0
    case $answer in
    files) compopt -o bashdefault -o default ;;
    folders) compopt -o dirnames ;;
    parts$'\n'*) compopt -o nospace ;;&
    parts$'\n'* | words$'\n'*) mapfile -t COMPREPLY <<<"${answer#*$'\n'}" ;;
    esac
}
complete -F _play_launch play-launch
