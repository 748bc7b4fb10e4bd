#compdef play-launch
# Completion of play-launch in zsh.

_play_launch() {
    local program=${words[1]/#\~/$HOME}
    local -a answer values shown
    # With the mark, the wheels of ROS leave Python alone: the answer needs no library of theirs.
    answer=("${(@f)$(_ROS_WHEELS_BOOTSTRAP_COMPLETE=1 "$program" completion --answer zsh \
        "${(j: :)words[1,CURRENT-1]} $PREFIX" 2>/dev/null </dev/null)}")
    case $answer[1] in
    files) _files ;;
    folders) _files -/ ;;
    words | parts)
        local line
        local -a more
        [[ $answer[1] == parts ]] && more=(-S '')
        for line in "${(@)answer[2,-1]}"; do
            values+=("${line%%$'\t'*}")
            shown+=("${line/$'\t'/  -- }")
        done
        # What matches was decided already, patterns among it.
        compadd -U -l $more -d shown -a values
        ;;
    esac
}

if [[ $funcstack[1] == _play-launch ]]; then
    _play_launch "$@"
else
    compdef _play_launch play-launch
fi
